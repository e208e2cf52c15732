"""People who talk with an agent in free text: kinds of persons, and what is counted of a talk."""
