"""Searches that go on: a file enters, a database of Optuna leaves, opened only if whole, free and of this very search.

What is searched, and how, is the business of the rooms above. Imports the terminal's masks and ``probe_env``'s files.
"""
