"""What a robot does for a while, as plain state machines with named failures: navigate, explore, dock."""
