"""The typed forms that the rooms of a study hand to each other, and what is declared of them."""
