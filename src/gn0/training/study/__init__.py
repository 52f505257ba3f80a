"""A study: walks of many policies, in one page with intervals and verdicts. Needs no torch."""
