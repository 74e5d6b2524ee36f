"""`rigel join`: a program of this computer in an application's network."""
