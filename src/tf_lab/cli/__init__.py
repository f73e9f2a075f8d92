"""What all commands share: the command line, its help and its errors."""
