"""Language of missions: routes put into words, by grammar or by a language model."""
