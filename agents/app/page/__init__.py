"""What is seen, by Bokeh: a screen a module, with the pictures that they share.

A screen has a ``layout`` and takes in what has happened when it is told to ``refresh``. Imports the rest of the app;
decides nothing that is stored.
"""
