"""What the tests of reconstruction share."""
