"""What boards are: their types, where their points lie, how they are written, what is printed on them."""
