"""Several modes of one posterior: found from many starts, weighed, and adapted by draws."""
