"""Tools of any room: errors, output, signals, files, seeds, statistics and reports."""
