"""GN-BAE, the paper's policy: its prompts and tokens, and its model by torch (extra `train`)."""
