"""What Aila, Karras and Laine published, and whether a study bears it out."""
