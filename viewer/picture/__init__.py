"""Drawing: layers by OpenGL, and the files made from them."""
