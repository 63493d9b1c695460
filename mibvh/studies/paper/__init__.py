"""The published figures and claims of Aila, Karras and Laine, compared with a study."""
