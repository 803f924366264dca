"""Results as text for a terminal: a report for each kind, and the tables that reports and ``pgmp info`` share.

A report takes the data of a result, the file that names it and the remarks that were printed before, and returns lines.
"""
