"""Published results: stages enter, files in their published places leave, from clean commits only.

What is stale, making it again in order, and whether changed code still gives the same. Imports records.
"""
