"""Recurrent baselines: cross-modal attention (CMA) and Seq2Seq, trained anew by GN0."""
