"""LiDAR-inertial odometry: an iterated error-state Kalman filter that registers raw points to planes of a voxel map (after FAST-LIO2)."""
