"""2-D SLAM by submaps and loop closure (Hess et al., "Real-Time Loop Closure in 2D LIDAR SLAM", 2016)."""
