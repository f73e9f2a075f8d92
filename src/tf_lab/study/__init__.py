"""The study: which runs are the same, how they are labelled and reported."""
