"""What was flown, written down: statistics, tables, documents, figures, files."""
