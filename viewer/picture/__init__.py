"""What is drawn: layers by OpenGL, and the files made from them."""
