"""What the measurements say: how well each predictor explains each of them."""
