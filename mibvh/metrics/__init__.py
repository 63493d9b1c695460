"""Metrics of a tree: SAH, EPO, LCV, and the predictors made of them."""
