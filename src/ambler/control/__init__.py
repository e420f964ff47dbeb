"""Local control: following a path inside a local cost grid, judging arrival and progress, and simple motions to get free."""
