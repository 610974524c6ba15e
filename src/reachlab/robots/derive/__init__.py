"""What a file does not state: which joints are the arm, its home, workspace, tool and servos."""
