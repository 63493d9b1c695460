// Dumps the tree of docs/examples/median_bvh.cpp in the layouts of other programs, from what their
// sources document: dump_tree TRIANGLES LAYOUT OUT. Prints the SAH of what it dumps.
#include <cstring>
#include <string>

#define main median_main
#include "../../docs/examples/median_bvh.cpp"
#undef main

struct BVHNode {  // tinybvh: the Wald layout
    float aabbMin[3];
    uint32_t leftFirst;
    float aabbMax[3];
    uint32_t triCount;
};
static_assert(sizeof(BVHNode) == 32, "");

// Siblings side by side, breadth first: an order that is neither the builder's nor mibvh's.
std::vector<int> order;
std::vector<uint32_t> child;  // of each place, the place of its first child
void pairs(uint32_t gap) {
    order = {0};
    for (uint32_t i = 0; i < gap; i++) order.push_back(-1);
    for (size_t p = 0; p < order.size(); p++) {
        child.push_back(0);
        if (order[p] < 0 || nodes[order[p]].left < 0) continue;
        child[p] = uint32_t(order.size());
        order.push_back(nodes[order[p]].left);
        order.push_back(nodes[order[p]].right);
    }
}

template <typename T> void put(FILE *f, T value) { fwrite(&value, sizeof value, 1, f); }

void tinybvh(FILE *f) {
    pairs(1);
    for (size_t p = 0; p < order.size(); p++) {
        BVHNode out;
        memset(&out, 0xcd, sizeof out);  // node 1 is never written to
        if (order[p] >= 0) {
            const mibvh_node &n = nodes[order[p]];
            memcpy(out.aabbMin, n.lower, 12);
            memcpy(out.aabbMax, n.upper, 12);
            out.leftFirst = n.left < 0 ? n.first : child[p];
            out.triCount = n.left < 0 ? n.count : 0;
        }
        put(f, out);
    }
    fwrite(ids.data(), 4, ids.size(), f);
}

template <typename T, typename Packed> void madmann91(FILE *f, bool packed) {
    pairs(0);
    put(f, uint64_t(order.size()));
    put(f, uint64_t(ids.size()));
    for (size_t p = 0; p < order.size(); p++) {
        const mibvh_node &n = nodes[order[p]];
        for (int k = 0; k < 3; k++) {
            put(f, T(n.lower[k]));
            put(f, T(n.upper[k]));
        }
        uint64_t first = n.left < 0 ? n.first : child[p], count = n.left < 0 ? n.count : 0;
        if (packed) {
            put(f, Packed(first << 4 | count));
        } else {
            put(f, first);
            put(f, count);
        }
    }
    for (uint32_t id : ids) put(f, uint64_t(id));
}

int main(int argc, char **argv) {
    if (argc != 4) return 1;
    FILE *in = fopen(argv[1], "rb");
    for (Triangle t; fread(&t, sizeof t, 1, in) == 1;) {
        ids.push_back(ids.size());
        triangles.push_back(t);
    }
    build(0, int(ids.size()));
    double sah = 0;
    for (const auto &n : nodes) sah += (n.left < 0 ? n.count : 1.2) * area(n) / area(nodes[0]);
    printf("%.9g\n", sah);
    FILE *f = fopen(argv[3], "wb");
    std::string layout = argv[2];
    if (layout == "tinybvh") tinybvh(f);
    if (layout == "tinybvh-save") {  // version and layout, triangles, the class, nodes, indices
        put(f, uint32_t(1 << 24 | 1 << 16 | 6 << 8 | 7));
        put(f, uint32_t(ids.size()));
        for (uint32_t i = 0; i < 50; i++) put(f, uint64_t(0x00007f00c0de0000ull + i));
        tinybvh(f);
    }
    if (layout == "madmann91") madmann91<float, uint32_t>(f, true);
    if (layout == "madmann91-double") madmann91<double, uint64_t>(f, true);
    if (layout == "madmann91-old") madmann91<float, uint32_t>(f, false);
    if (layout == "madmann91-old-double") madmann91<double, uint64_t>(f, false);
    return fclose(f);
}
