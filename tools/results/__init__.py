"""Makes the tables, figures and quoted numbers of the documentation anew: ``make results``."""
