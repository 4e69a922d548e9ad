"""Searches that go on: databases of Optuna, opened only if they are whole, free and of this very search.

What is searched, and how, is the business of the rooms above. Imports the terminal's masks and ``probe_env``'s files.
"""
