"""Training: the Lightning module, losses, schedule, callbacks."""
