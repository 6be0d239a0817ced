"""What is known of the tyres: information (Eq. 6, 7), belief (Eq. 8), revisions, live residuals."""
