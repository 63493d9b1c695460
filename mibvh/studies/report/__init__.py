"""What people and programs read: tables, figures, the page, files, progress."""
