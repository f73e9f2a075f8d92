"""Which runs are the same, where they lie, who made them, and how sweeps run them."""
