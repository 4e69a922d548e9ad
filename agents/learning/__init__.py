"""Training: a file of settings enters, a bundle of plain arrays leaves. The room of torch and Stable-Baselines3.

Imports policies and what is below them.
"""
