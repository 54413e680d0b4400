"""What a robot model leaves out: track ← catalogue ← search ← judge ← diagnosis."""
