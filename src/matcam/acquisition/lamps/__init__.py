"""What highlights say of lamps that somebody wrote down."""
