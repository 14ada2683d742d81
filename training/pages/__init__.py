"""The pages of every report: one frame, one table, one style of figures, one form of numbers.

A report is a view function, which gathers values, and a template under ``templates/``.
"""
