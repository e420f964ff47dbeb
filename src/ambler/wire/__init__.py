"""Bytes: the only place where formats of files and messages live."""
