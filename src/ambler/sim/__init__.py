"""The simulator: a world with robots, people, doors and docks; physics, ray-cast sensors, cameras, faults."""
