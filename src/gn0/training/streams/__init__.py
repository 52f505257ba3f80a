"""Streams of labelled states: of datasets, of walks beside the learner, of anywhere."""
