"""Evaluation of policies on the same tubes: KPIs, paired statistics, reports, films and inspection signals."""
