"""Training of policies by torch (extra `train`): streams of samples, stages, runs that resume."""
