"""Materials on a surface that depend on its curvature: one query per hit gives reflectance and opacity."""
