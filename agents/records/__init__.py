"""What is stored: rows and files enter whole, validated tables leave, and each knows what made it.

Imports the terminal's names, ``probe_env``'s models and the list of methods; knows no policy.
"""
