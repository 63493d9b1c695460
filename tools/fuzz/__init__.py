"""Damaged and hostile input from seeds; see :mod:`tools.fuzz.__main__`."""
