"""Accuracy against cost over all methods, and beside other packages."""
