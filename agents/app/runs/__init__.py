"""Insertions that are watched: what is wanted enters, frames and ordinary evaluation folders leave.

A worker process plays, so that the page answers meanwhile; what is finished is stored before the page hears of it.
Imports policies, rollouts, processes, evaluation and the episodes; knows no page.
"""
