"""Scans, clouds, IMU and odometry out of logs and bags, for 2-D and 3-D alike; recorded devices."""
