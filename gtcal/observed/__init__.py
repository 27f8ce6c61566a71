"""What all rooms hand to each other: views, what was left out of them, and the unknowns. No readers, no solvers."""
