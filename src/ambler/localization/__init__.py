"""Where the robot is: EKF, particle filter, grid tracker, reflectors, relocalization, supervision."""
