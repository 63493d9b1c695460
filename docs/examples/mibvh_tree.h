/* Writes a binary BVH for mibvh: `mibvh import FILE --layout mibvh -o TREE.npz`. C99 or C++,
   little-endian machines. Node 0 is the root; nodes may stand in any order, and some be unused.

   Inner node: left and right are its children, first and count are not looked at.
   Leaf:       left = -1; its triangles are indices[first], ..., indices[first + count - 1].

   Boxes are closed, in the scene's units, and lie within their parent's. A triangle that is split
   stands in several leaves, whose boxes hold all of it between them.

   The file: "MIBVH\1\r\n", uint32 n, uint32 m, n nodes of 40 bytes, m uint32 triangle ids. */
#ifndef MIBVH_TREE_H
#define MIBVH_TREE_H

#include <stdint.h>
#include <stdio.h>

typedef struct mibvh_node {
    float lower[3], upper[3];
    int32_t left, right;
    int32_t first, count;
} mibvh_node;

/* Returns 1, or 0 if the file could not be written. */
static int write_mibvh_tree(FILE *file, const mibvh_node *nodes, uint32_t n,
                            const uint32_t *indices, uint32_t m) {
    const uint32_t sizes[2] = {n, m};
    return fwrite("MIBVH\1\r\n", 8, 1, file) == 1 && fwrite(sizes, 4, 2, file) == 2 &&
           fwrite(nodes, sizeof(mibvh_node), n, file) == n && fwrite(indices, 4, m, file) == m;
}

#endif
