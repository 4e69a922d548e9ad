"""What is typed and dragged: texts and points enter, plants and schedules or one-line errors leave.

Fields, ranges, units and errors are those of the models that the files are read with. Imports policies,
logs, records and the package's models and plants; knows no page.
"""
