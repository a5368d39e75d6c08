"""Raw logs and files of other programs as tables in SI units on GPS time, nothing lost without being
counted.
"""
