// Rows of arrays without padding.

// Row i of an array with three floats per row.
#define ROW3(array, i) vec3(array[3 * (i)], array[3 * (i) + 1], array[3 * (i) + 2])
