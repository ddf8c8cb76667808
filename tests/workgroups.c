// A Vulkan layer for tests: the workgroups of every dispatch run in another order. A dispatch of n workgroups is cut along its
// last dimension that has more than one into pieces, and these are dispatched one after the other: the second half before the
// first (DPGES_WORKGROUPS=0), or up to 32 pieces in an order drawn from a seed (any other number). At the end it says on
// stderr what it did. Kernels must not ask for the number of workgroups in that dimension: they would get that of a piece.
//
//     gcc -shared -fPIC -O2 -o libworkgroups.so workgroups.c    # headers: Debian's libvulkan-dev
//
// One device a process: functions of the driver are kept once. tests/drivers.py writes the manifest and compares scenes.

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <vulkan/vk_layer.h>
#include <vulkan/vulkan.h>

#define MOST_PIECES 32
#define EXPORT __attribute__((visibility("default")))

static PFN_vkGetInstanceProcAddr next_instance_proc;
static PFN_vkGetDeviceProcAddr next_device_proc;
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

static VKAPI_ATTR VkResult VKAPI_CALL create_compute_pipelines(VkDevice device, VkPipelineCache cache, uint32_t n,
                                                               const VkComputePipelineCreateInfo *given,
                                                               const VkAllocationCallbacks *allocator, VkPipeline *made) {
    VkComputePipelineCreateInfo *infos = malloc(n * sizeof *infos);
    if (infos == NULL) return VK_ERROR_OUT_OF_HOST_MEMORY;
    memcpy(infos, given, n * sizeof *infos);
    for (uint32_t i = 0; i < n; i++) infos[i].flags |= VK_PIPELINE_CREATE_DISPATCH_BASE_BIT;
    VkResult result = create_pipelines(device, cache, n, infos, allocator, made);
    free(infos);
    return result;
}

static VKAPI_ATTR VkResult VKAPI_CALL create_instance(const VkInstanceCreateInfo *info, const VkAllocationCallbacks *allocator,
                                                      VkInstance *instance) {
    VkLayerInstanceCreateInfo *link = (VkLayerInstanceCreateInfo *)info->pNext;
    while (link && !(link->sType == VK_STRUCTURE_TYPE_LOADER_INSTANCE_CREATE_INFO && link->function == VK_LAYER_LINK_INFO))
        link = (VkLayerInstanceCreateInfo *)link->pNext;
    if (link == NULL) return VK_ERROR_INITIALIZATION_FAILED;
    next_instance_proc = link->u.pLayerInfo->pfnNextGetInstanceProcAddr;
    link->u.pLayerInfo = link->u.pLayerInfo->pNext;
    return ((PFN_vkCreateInstance)next_instance_proc(NULL, "vkCreateInstance"))(info, allocator, instance);
}

static VKAPI_ATTR VkResult VKAPI_CALL create_device(VkPhysicalDevice gpu, const VkDeviceCreateInfo *info,
                                                    const VkAllocationCallbacks *allocator, VkDevice *device) {
    VkLayerDeviceCreateInfo *link = (VkLayerDeviceCreateInfo *)info->pNext;
    while (link && !(link->sType == VK_STRUCTURE_TYPE_LOADER_DEVICE_CREATE_INFO && link->function == VK_LAYER_LINK_INFO))
        link = (VkLayerDeviceCreateInfo *)link->pNext;
    if (link == NULL) return VK_ERROR_INITIALIZATION_FAILED;
    PFN_vkGetInstanceProcAddr instance_proc = link->u.pLayerInfo->pfnNextGetInstanceProcAddr;
    next_device_proc = link->u.pLayerInfo->pfnNextGetDeviceProcAddr;
    link->u.pLayerInfo = link->u.pLayerInfo->pNext;
    VkResult result = ((PFN_vkCreateDevice)instance_proc(NULL, "vkCreateDevice"))(gpu, info, allocator, device);
    if (result != VK_SUCCESS) return result;
    create_pipelines = (PFN_vkCreateComputePipelines)next_device_proc(*device, "vkCreateComputePipelines");
    dispatch_base = (PFN_vkCmdDispatchBase)next_device_proc(*device, "vkCmdDispatchBase");
    return create_pipelines && dispatch_base ? result : VK_ERROR_INITIALIZATION_FAILED;
}

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL device_proc(VkDevice device, const char *name);

static PFN_vkVoidFunction own(const char *name) {
    if (!strcmp(name, "vkCreateInstance")) return (PFN_vkVoidFunction)create_instance;
    if (!strcmp(name, "vkCreateDevice")) return (PFN_vkVoidFunction)create_device;
    if (!strcmp(name, "vkGetDeviceProcAddr")) return (PFN_vkVoidFunction)device_proc;
    if (!strcmp(name, "vkCmdDispatch")) return (PFN_vkVoidFunction)cmd_dispatch;
    if (!strcmp(name, "vkCreateComputePipelines")) return (PFN_vkVoidFunction)create_compute_pipelines;
    return NULL;
}

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL device_proc(VkDevice device, const char *name) {
    PFN_vkVoidFunction found = own(name);
    return found ? found : next_device_proc(device, name);
}

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL instance_proc(VkInstance instance, const char *name) {
    PFN_vkVoidFunction found = own(name);
    return found ? found : next_instance_proc ? next_instance_proc(instance, name) : NULL;
}

EXPORT VKAPI_ATTR VkResult VKAPI_CALL vkNegotiateLoaderLayerInterfaceVersion(VkNegotiateLayerInterface *interface) {
    const char *given = getenv("DPGES_WORKGROUPS");
    state = seed = given ? strtoull(given, NULL, 10) : 0;
    interface->loaderLayerInterfaceVersion = 2;
    interface->pfnGetInstanceProcAddr = instance_proc;
    interface->pfnGetDeviceProcAddr = device_proc;
    interface->pfnGetPhysicalDeviceProcAddr = NULL;
    return VK_SUCCESS;
}

__attribute__((destructor)) static void report(void) {
    fprintf(stderr, "workgroups: %llu dispatches, %llu of them cut\n", (unsigned long long)dispatches, (unsigned long long)cut);
}
