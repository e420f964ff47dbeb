"""What leaves a robot without delaying it: the live view for Foxglove, and recordings."""
