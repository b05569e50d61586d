"""The next few activations from where the robots are: a beam search over maps of cost-to-go."""
