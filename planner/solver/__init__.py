"""Sequential quadratic programming: compiled stage functions, QP backends, and the peer they are judged by."""
