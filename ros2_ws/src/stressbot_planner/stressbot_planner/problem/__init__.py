"""What is asked and what is answered: problems, bounds on their plans, proofs that there is none, plans."""
