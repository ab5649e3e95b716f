"""The experiments of a thesis on vertex connection and merging (Czech Technical University, about 2013), made again."""
