"""What a model predicts of a record, with sensitivities to its parameters."""
