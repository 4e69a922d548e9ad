"""The page of an evaluation: a folder of tables, or of what an interrupted run left, enters; one HTML file leaves.

Imports policies and what is below them. ``templates/`` has the page, its style and script, and uPlot (MIT), which draws
the interactive pictures.
"""
