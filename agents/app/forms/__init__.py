"""What is typed and dragged: texts and points enter, plants and schedules or one-line errors leave.

Fields, ranges, units and errors are those of the models that the files are read with. Knows no page.
"""
