"""Screens of the page, built with Bokeh."""
