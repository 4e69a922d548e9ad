"""What is stored: rows and files enter whole, validated tables leave, and each knows what made it.

Imports the terminal's names and ``probe_env``'s models; knows no policy.
"""
