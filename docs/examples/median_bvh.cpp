// A BVH by median splits, for mibvh: median_bvh TRIANGLES TREE. Compile: g++ -O2 median_bvh.cpp
// TRIANGLES is what `mibvh triangles SCENE -o TRIANGLES` writes: nine floats per triangle.
#include <algorithm>
#include <array>
#include <vector>
#include "mibvh_tree.h"
using Triangle = std::array<float, 9>;
std::vector<Triangle> triangles;
std::vector<mibvh_node> nodes;
std::vector<uint32_t> ids;
float middle(uint32_t t, int k) { return triangles[t][k] + triangles[t][k + 3] + triangles[t][k + 6]; }
double area(const mibvh_node &n) {
    double x = double(n.upper[0]) - n.lower[0], y = double(n.upper[1]) - n.lower[1], z = double(n.upper[2]) - n.lower[2];
    return x * y + y * z + z * x;
}
int build(int first, int count) {
    mibvh_node node{{1e30f, 1e30f, 1e30f}, {-1e30f, -1e30f, -1e30f}, -1, -1, first, count};
    for (int i = first; i < first + count; i++)
        for (int k = 0; k < 9; k++) {
            node.lower[k % 3] = std::min(node.lower[k % 3], triangles[ids[i]][k]);
            node.upper[k % 3] = std::max(node.upper[k % 3], triangles[ids[i]][k]);
        }
    int self = int(nodes.size()), half = count / 2, axis = 0;
    nodes.push_back(node);
    if (count <= 4) return self;
    for (int k = 1; k < 3; k++)
        if (node.upper[k] - node.lower[k] > node.upper[axis] - node.lower[axis]) axis = k;
    std::nth_element(&ids[first], &ids[first + half], &ids[first] + count,
                     [=](uint32_t a, uint32_t b) { return middle(a, axis) < middle(b, axis); });
    int left = build(first, half), right = build(first + half, count - half);
    nodes[self].left = left; // only now: nodes has moved in memory meanwhile
    nodes[self].right = right;
    return self;
}
int main(int argc, char **argv) {
    FILE *in = argc == 3 ? fopen(argv[1], "rb") : nullptr;
    for (Triangle t; in && fread(&t, sizeof t, 1, in) == 1;) { ids.push_back(ids.size()); triangles.push_back(t); }
    if (ids.empty()) return 1;
    build(0, int(ids.size()));
    double sah = 0;
    for (const auto &n : nodes) sah += (n.left < 0 ? n.count : 1.2) * area(n) / area(nodes[0]);
    printf("%zu nodes, SAH %.9g\n", nodes.size(), sah);
    FILE *out = fopen(argv[2], "wb");
    return out && write_mibvh_tree(out, nodes.data(), nodes.size(), ids.data(), ids.size()) && !fclose(out) ? 0 : 1;
}
