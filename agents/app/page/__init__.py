"""What is seen, by Bokeh: frames, tables and what is clicked enter, screens with their pictures leave; one a module.

A screen has a ``layout`` and takes in what has happened when it is asked to ``refresh``; it decides nothing that is
stored. Imports the rest of the app, evaluation's tables, designs, policies and the environments' pictures.
"""
