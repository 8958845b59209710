"""A scene in the browser: camera by mouse, parameters by sliders, pictures that refine (extra `viewer`)."""
