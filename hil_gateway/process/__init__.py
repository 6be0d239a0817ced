"""What every process needs: errors, clock, configuration, scheduling, supervision, compiled functions."""
