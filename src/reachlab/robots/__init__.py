"""What an arm is: its model file, chain, kinematics and limits."""
