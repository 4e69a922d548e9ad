"""One float pitch of cable as a superelement: a chain enters, condensed matrices leave.

Imports the chain alone.
"""
