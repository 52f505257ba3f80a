"""State, kinematics, collision, sensors, simulator, environments and the policy protocol."""
