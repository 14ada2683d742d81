"""The public Python API of the offline part; ``training`` offers its names, imported on first use.

It does what ``o2train`` does: ``recordings`` reads, ``models`` fits and evaluates, ``workflows``
finds gaps and estimates tables.
"""
