// A Vulkan layer for tests: the workgroups of every dispatch run in another order. A dispatch of n workgroups is cut along its
// last dimension that has more than one into pieces, and these are dispatched one after the other: the second half before the
// first (DPGES_WORKGROUPS=0), or up to 32 pieces in an order drawn from a seed (any other number). At the end it says on
// stderr what it did. Kernels must not ask for the number of workgroups in that dimension: they would get that of a piece.
//
//     gcc -shared -fPIC -O2 -o libworkgroups.so workgroups.c    # headers: Debian's libvulkan-dev
//
// tests/drivers.py writes the manifest and compares scenes.

#include "layer.h"

#define MOST_PIECES 32

static PFN_vkCreateComputePipelines create_pipelines;
static PFN_vkCmdDispatchBase dispatch_base;
static uint64_t seed, state;
static uint64_t dispatches, cut;

static uint64_t draw(uint64_t below) {
    // splitmix64
    uint64_t z = (state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (z ^ (z >> 31)) % below;
}

static VKAPI_ATTR void VKAPI_CALL cmd_dispatch(VkCommandBuffer commands, uint32_t x, uint32_t y, uint32_t z) {
    uint32_t count[3] = {x, y, z}, base[3] = {0, 0, 0};
    int last = z > 1 ? 2 : y > 1 ? 1 : 0;
    uint32_t n = count[last], pieces = n < 2 ? 1 : seed == 0 ? 2 : n < MOST_PIECES ? n : MOST_PIECES;
    uint32_t order[MOST_PIECES];
    for (uint32_t i = 0; i < pieces; i++) order[i] = pieces - 1 - i;
    for (uint32_t i = pieces; seed != 0 && i > 1; i--) {
        uint32_t other = (uint32_t)draw(i), kept = order[i - 1];
        order[i - 1] = order[other];
        order[other] = kept;
    }
    dispatches++;
    cut += pieces > 1;
    for (uint32_t i = 0; i < pieces; i++) {
        uint32_t from = (uint32_t)((uint64_t)n * order[i] / pieces), to = (uint32_t)((uint64_t)n * (order[i] + 1) / pieces);
        base[last] = from;
        count[last] = to - from;
        dispatch_base(commands, base[0], base[1], base[2], count[0], count[1], count[2]);
    }
}

static VKAPI_ATTR VkResult VKAPI_CALL create_compute_pipelines(VkDevice of, VkPipelineCache cache, uint32_t n,
                                                               const VkComputePipelineCreateInfo *given,
                                                               const VkAllocationCallbacks *allocator, VkPipeline *made) {
    VkComputePipelineCreateInfo *infos = malloc(n * sizeof *infos);
    if (infos == NULL) return VK_ERROR_OUT_OF_HOST_MEMORY;
    memcpy(infos, given, n * sizeof *infos);
    for (uint32_t i = 0; i < n; i++) infos[i].flags |= VK_PIPELINE_CREATE_DISPATCH_BASE_BIT;
    VkResult result = create_pipelines(of, cache, n, infos, allocator, made);
    free(infos);
    return result;
}

static void layer_loaded(void) {
    const char *given = getenv("DPGES_WORKGROUPS");
    state = seed = given ? strtoull(given, NULL, 10) : 0;
}

static VkResult instance_created(VkInstance instance) {
    (void)instance;
    return VK_SUCCESS;
}

static VkResult device_created(const VkDeviceCreateInfo *info) {
    (void)info;
    create_pipelines = NEXT(vkCreateComputePipelines);
    dispatch_base = NEXT(vkCmdDispatchBase);
    return create_pipelines && dispatch_base ? VK_SUCCESS : VK_ERROR_INITIALIZATION_FAILED;
}

static PFN_vkVoidFunction taken(const char *name) {
    TAKE(name, vkCmdDispatch, cmd_dispatch);
    TAKE(name, vkCreateComputePipelines, create_compute_pipelines);
    return NULL;
}

__attribute__((destructor)) static void report(void) {
    fprintf(stderr, "workgroups: %llu dispatches, %llu of them cut\n", (unsigned long long)dispatches, (unsigned long long)cut);
}
