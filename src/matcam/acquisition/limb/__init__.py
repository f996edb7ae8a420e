"""The limb of a sphere in a picture: its circle, its edges, and what it mirrors of a bright field."""
