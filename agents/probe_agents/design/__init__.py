"""Comparison of probe designs and search for better ones, in the study's tubes or a plant's."""
