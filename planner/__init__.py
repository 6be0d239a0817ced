"""Information-maximising MPCC (Eq. 4, 5, 9, 10, Algorithm 1) solved by SQP in real time."""
