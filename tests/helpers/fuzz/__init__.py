"""Files that someone damaged, or made to do harm, and every reader that meets them.

python -m helpers.fuzz KIND COUNT [FIRST] tries so many damaged copies of a kind of files in a
process of its own, within limits of time and memory, and prints as JSON what was not answered by a
clear error; a seed is all that a try depends on.
"""
