"""What is known of the road before driving: race line, speed profile, grip envelope, the track along the line."""
