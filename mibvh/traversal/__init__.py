"""Traversal: the Dr.Jit kernels, the records they read, and warps simulated in lockstep."""
