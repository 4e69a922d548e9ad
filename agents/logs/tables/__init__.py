"""Tables of texts: the bytes of a text or a workbook enter, cells as they are written leave, head and units found.

Imports quantities and units of ``logs``; knows no numbers.
"""
