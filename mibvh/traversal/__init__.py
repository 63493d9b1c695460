"""Traversal: the one Dr.Jit kernel, and the records it reads."""
