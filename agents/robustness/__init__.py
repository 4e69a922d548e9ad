"""How robust policies are: policies and a place enter, what each loses along every axis leaves, as table and picture.

``axes`` says what is disturbed, ``study`` plays and compares. Imports policies, rollouts and records.
"""
