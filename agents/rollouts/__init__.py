"""Playing policies: policies, contexts and seeds enter, tables of KPIs and intervals leave.

The only loop that plays policies for a table. Imports records and processes.
"""
