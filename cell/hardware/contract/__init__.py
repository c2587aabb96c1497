"""The contract of a cell's ports (robots/ports.py) as clauses that any driver can be checked against."""
