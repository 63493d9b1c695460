"""The generators of the bundled scenes: one file per family, `primitives` shared by all."""
