"""Output for people and programs: tables, figures, the page, data files, progress."""
