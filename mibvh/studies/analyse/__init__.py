"""Analysis of the records: how well each predictor explains each measurement."""
