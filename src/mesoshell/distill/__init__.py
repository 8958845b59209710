"""Surface materials distilled from neural shells or geometry: from what, and how different they look."""
