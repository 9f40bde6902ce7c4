"""Programs for people: command line, authoring of cells, observers, demos. No process of a cluster imports them."""
