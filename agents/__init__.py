"""Deciding and judging: the command, studies, reports; later policies, training and design search."""
