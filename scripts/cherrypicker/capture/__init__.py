"""Photos as they come from the field: sharp, well exposed, all round the tree, markers in view?"""
