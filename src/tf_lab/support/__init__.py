"""What everything may use: files, locks, processes, progress, text."""
