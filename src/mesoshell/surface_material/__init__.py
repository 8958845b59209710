"""Materials on a surface that know its curvature: one query a hit gives reflectance and opacity."""
