"""Race tracks: files and layouts to centre line, widths, elevation and bank over arc length."""
