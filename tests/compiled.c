// A Vulkan layer for tests: every pipeline of a run is also compiled for a card of AMD that need not be there, and counted. Mesa's
// AMD driver (DPGES_COMPILED_DRIVER, libvulkan_radeon.so of Mesa 25) makes a card that runs nothing if RADV_FORCE_FAMILY names
// one; what the run creates on its own device is created there again. The run is told the card's kind and sizes of subgroups, so
// that its shaders are those the card would get: it is right only where no kernel asks another unit of its subgroup. At the end
// DPGES_COMPILED_TABLE has a line of JSON for the card and one for each stage of each pipeline: the driver's statistics, and how
// often it ran.
//
//     gcc -shared -fPIC -O2 -o libcompiled.so compiled.c -ldl    # headers: Debian's libvulkan-dev
//
// Calls that make what a pipeline refers to are those of wgpu. tests/drivers.py writes the manifest and reads the table.

#include "layer.h"

#include <dlfcn.h>
#include <pthread.h>

#define MOST_STAGES 4
#define MOST_STATISTICS 64
#define OF_CARD(name) ((PFN_##name)card_proc(card_instance, #name))

// an object of the run, beside what stands for it on the card: a handle, or a place among pipelines
typedef struct {
    uint64_t here, there;
    uint32_t workgroup[3];
} Object;

typedef struct {
    uint64_t launches, workgroups;
    uint32_t workgroup[3];
    uint32_t stages;
    VkShaderStageFlags flags[MOST_STAGES];
    char *names[MOST_STAGES];
    char *label;
    VkPipeline there;
} Pipeline;

static PFN_vkGetInstanceProcAddr card_proc;
static VkInstance card_instance;
static VkPhysicalDevice card;
static VkDevice card_device;
static PFN_vkGetPhysicalDeviceProperties next_kind;
static PFN_vkGetPhysicalDeviceProperties2 next_properties;
static PFN_vkGetPhysicalDeviceFeatures2 next_features;
static VkPhysicalDeviceType kind;
static uint32_t smallest_subgroup, largest_subgroup;
static Object *objects;
static Pipeline *pipelines;
static size_t n_objects, n_pipelines;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

static void *grown(void *list, size_t n, size_t size) {
    // a power of two is full
    void *longer = n & (n - 1) ? list : realloc(list, (n ? 2 * n : 1) * size);
    if (longer == NULL) abort();
    return longer;
}

static Object *find(uint64_t here) {
    for (size_t i = n_objects; i-- > 0;)
        if (objects[i].here == here) return &objects[i];
    return NULL;
}

static uint64_t there(const void *here) {
    pthread_mutex_lock(&lock);
    Object *found = find((uint64_t)here);
    uint64_t handle = found ? found->there : 0;
    pthread_mutex_unlock(&lock);
    return handle;
}

// handles are used again once their object is gone: the last one counts
static void keep(const void *here, uint64_t there, const uint32_t *workgroup) {
    pthread_mutex_lock(&lock);
    Object *object = find((uint64_t)here);
    if (object == NULL) {
        objects = grown(objects, n_objects, sizeof *objects);
        object = &objects[n_objects++];
    }
    *object = (Object){.here = (uint64_t)here, .there = there};
    if (workgroup) memcpy(object->workgroup, workgroup, sizeof object->workgroup);
    pthread_mutex_unlock(&lock);
}

static void check(VkResult result, const char *what) {
    if (result == VK_SUCCESS) return;
    fprintf(stderr, "compiled: %s failed on the card: %d\n", what, result);
    exit(1);
}

static VKAPI_ATTR VkResult VKAPI_CALL create_shader_module(VkDevice of, const VkShaderModuleCreateInfo *info,
                                                           const VkAllocationCallbacks *allocator, VkShaderModule *made) {
    VkResult result = NEXT(vkCreateShaderModule)(of, info, allocator, made);
    if (result != VK_SUCCESS) return result;
    VkShaderModule copy;
    check(OF_CARD(vkCreateShaderModule)(card_device, info, NULL, &copy), "vkCreateShaderModule");
    uint32_t workgroup[3] = {0, 0, 0};
    // after five words of the header: OpExecutionMode entry LocalSize x y z
    for (size_t at = 5, words = info->codeSize / 4; at + 5 < words && info->pCode[at] >> 16; at += info->pCode[at] >> 16)
        if (info->pCode[at] == (6u << 16 | 16) && info->pCode[at + 2] == 17) memcpy(workgroup, &info->pCode[at + 3], sizeof workgroup);
    keep(*made, (uint64_t)copy, workgroup);
    return result;
}

// an object that refers to no other is made on the card as it is here
#define COPIED(create, name)                                                                                                   \
    static VKAPI_ATTR VkResult VKAPI_CALL create(VkDevice of, const Vk##name##CreateInfo *info,                                \
                                                 const VkAllocationCallbacks *allocator, Vk##name *made) {                     \
        VkResult result = NEXT(vkCreate##name)(of, info, allocator, made);                                                     \
        if (result != VK_SUCCESS) return result;                                                                               \
        Vk##name copy;                                                                                                         \
        check(OF_CARD(vkCreate##name)(card_device, info, NULL, &copy), "vkCreate" #name);                                      \
        keep(*made, (uint64_t)copy, NULL);                                                                                     \
        return result;                                                                                                         \
    }
COPIED(create_set_layout, DescriptorSetLayout)
COPIED(create_render_pass, RenderPass)

static VKAPI_ATTR VkResult VKAPI_CALL create_layout(VkDevice of, const VkPipelineLayoutCreateInfo *info,
                                                    const VkAllocationCallbacks *allocator, VkPipelineLayout *made) {
    VkResult result = NEXT(vkCreatePipelineLayout)(of, info, allocator, made);
    if (result != VK_SUCCESS) return result;
    VkDescriptorSetLayout sets[32];
    VkPipelineLayoutCreateInfo changed = *info;
    changed.pSetLayouts = sets;
    for (uint32_t i = 0; i < info->setLayoutCount; i++) sets[i] = (VkDescriptorSetLayout)there(info->pSetLayouts[i]);
    VkPipelineLayout copy;
    check(OF_CARD(vkCreatePipelineLayout)(card_device, &changed, NULL, &copy), "vkCreatePipelineLayout");
    keep(*made, (uint64_t)copy, NULL);
    return result;
}

static void keep_pipeline(VkPipeline here, VkPipeline there, const VkPipelineShaderStageCreateInfo *stages, uint32_t n) {
    pthread_mutex_lock(&lock);
    pipelines = grown(pipelines, n_pipelines, sizeof *pipelines);
    Pipeline *pipeline = &pipelines[n_pipelines];
    *pipeline = (Pipeline){.stages = n, .there = there};
    for (uint32_t i = 0; i < n; i++) {
        pipeline->flags[i] = stages[i].stage;
        pipeline->names[i] = strdup(stages[i].pName);
        memcpy(pipeline->workgroup, find((uint64_t)stages[i].module)->workgroup, sizeof pipeline->workgroup);
    }
    uint64_t place = n_pipelines++;
    pthread_mutex_unlock(&lock);
    keep(here, place, NULL);
}

static VKAPI_ATTR VkResult VKAPI_CALL create_compute_pipelines(VkDevice of, VkPipelineCache cache, uint32_t n,
                                                               const VkComputePipelineCreateInfo *infos,
                                                               const VkAllocationCallbacks *allocator, VkPipeline *made) {
    VkResult result = NEXT(vkCreateComputePipelines)(of, cache, n, infos, allocator, made);
    for (uint32_t i = 0; result == VK_SUCCESS && i < n; i++) {
        VkComputePipelineCreateInfo info = infos[i];
        info.flags |= VK_PIPELINE_CREATE_CAPTURE_STATISTICS_BIT_KHR;
        info.layout = (VkPipelineLayout)there(info.layout);
        info.stage.module = (VkShaderModule)there(info.stage.module);
        VkPipeline copy;
        check(OF_CARD(vkCreateComputePipelines)(card_device, VK_NULL_HANDLE, 1, &info, NULL, &copy), infos[i].stage.pName);
        keep_pipeline(made[i], copy, &infos[i].stage, 1);
    }
    return result;
}

static VKAPI_ATTR VkResult VKAPI_CALL create_graphics_pipelines(VkDevice of, VkPipelineCache cache, uint32_t n,
                                                                const VkGraphicsPipelineCreateInfo *infos,
                                                                const VkAllocationCallbacks *allocator, VkPipeline *made) {
    VkResult result = NEXT(vkCreateGraphicsPipelines)(of, cache, n, infos, allocator, made);
    for (uint32_t i = 0; result == VK_SUCCESS && i < n; i++) {
        VkGraphicsPipelineCreateInfo info = infos[i];
        VkPipelineShaderStageCreateInfo stages[MOST_STAGES];
        if (info.stageCount > MOST_STAGES) check(VK_ERROR_FEATURE_NOT_PRESENT, "a pipeline of more stages");
        for (uint32_t stage = 0; stage < info.stageCount; stage++) {
            stages[stage] = info.pStages[stage];
            stages[stage].module = (VkShaderModule)there(stages[stage].module);
        }
        info.flags |= VK_PIPELINE_CREATE_CAPTURE_STATISTICS_BIT_KHR;
        info.pStages = stages;
        info.layout = (VkPipelineLayout)there(info.layout);
        info.renderPass = (VkRenderPass)there(info.renderPass);
        VkPipeline copy;
        check(OF_CARD(vkCreateGraphicsPipelines)(card_device, VK_NULL_HANDLE, 1, &info, NULL, &copy), stages[0].pName);
        keep_pipeline(made[i], copy, infos[i].pStages, info.stageCount);
    }
    return result;
}

static VKAPI_ATTR VkResult VKAPI_CALL name_object(VkDevice of, const VkDebugUtilsObjectNameInfoEXT *info) {
    if (info->objectType == VK_OBJECT_TYPE_PIPELINE && info->pObjectName) {
        pthread_mutex_lock(&lock);
        pipelines[find(info->objectHandle)->there].label = strdup(info->pObjectName);
        pthread_mutex_unlock(&lock);
    }
    return NEXT(vkSetDebugUtilsObjectNameEXT)(of, info);
}

static VKAPI_ATTR void VKAPI_CALL bind_pipeline(VkCommandBuffer commands, VkPipelineBindPoint point, VkPipeline pipeline) {
    keep(commands, there(pipeline), NULL);
    NEXT(vkCmdBindPipeline)(commands, point, pipeline);
}

static void count(VkCommandBuffer commands, uint64_t workgroups) {
    pthread_mutex_lock(&lock);
    Pipeline *pipeline = &pipelines[find((uint64_t)commands)->there];
    pipeline->launches++;
    pipeline->workgroups += workgroups;
    pthread_mutex_unlock(&lock);
}

static VKAPI_ATTR void VKAPI_CALL dispatch(VkCommandBuffer commands, uint32_t x, uint32_t y, uint32_t z) {
    count(commands, (uint64_t)x * y * z);
    NEXT(vkCmdDispatch)(commands, x, y, z);
}

static VKAPI_ATTR void VKAPI_CALL dispatch_indirect(VkCommandBuffer commands, VkBuffer buffer, VkDeviceSize at) {
    count(commands, 0);
    NEXT(vkCmdDispatchIndirect)(commands, buffer, at);
}

static VKAPI_ATTR void VKAPI_CALL draw(VkCommandBuffer commands, uint32_t vertices, uint32_t instances, uint32_t vertex, uint32_t at) {
    count(commands, 0);
    NEXT(vkCmdDraw)(commands, vertices, instances, vertex, at);
}

static VKAPI_ATTR void VKAPI_CALL draw_indirect(VkCommandBuffer commands, VkBuffer buffer, VkDeviceSize at, uint32_t n, uint32_t step) {
    count(commands, 0);
    NEXT(vkCmdDrawIndirect)(commands, buffer, at, n, step);
}

static VKAPI_ATTR void VKAPI_CALL get_kind(VkPhysicalDevice gpu, VkPhysicalDeviceProperties *properties) {
    next_kind(gpu, properties);
    properties->deviceType = kind;
}

static VKAPI_ATTR void VKAPI_CALL get_properties(VkPhysicalDevice gpu, VkPhysicalDeviceProperties2 *properties) {
    next_properties(gpu, properties);
    for (VkBaseOutStructure *next = properties->pNext; next; next = next->pNext) {
        VkPhysicalDeviceSubgroupSizeControlProperties *given = (VkPhysicalDeviceSubgroupSizeControlProperties *)next;
        if (next->sType != VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_SIZE_CONTROL_PROPERTIES) continue;
        given->minSubgroupSize = smallest_subgroup;
        given->maxSubgroupSize = largest_subgroup;
    }
}

// of what lavapipe has and wgpu asks for, only this differs between cards
static VKAPI_ATTR void VKAPI_CALL get_features(VkPhysicalDevice gpu, VkPhysicalDeviceFeatures2 *features) {
    next_features(gpu, features);
    VkPhysicalDeviceShaderAtomicFloatFeaturesEXT atomics = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_ATOMIC_FLOAT_FEATURES_EXT};
    VkPhysicalDeviceFeatures2 of_card = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2, .pNext = &atomics};
    OF_CARD(vkGetPhysicalDeviceFeatures2)(card, &of_card);
    for (VkBaseOutStructure *next = features->pNext; next; next = next->pNext) {
        VkPhysicalDeviceShaderAtomicFloatFeaturesEXT *given = (VkPhysicalDeviceShaderAtomicFloatFeaturesEXT *)next;
        if (next->sType == atomics.sType) given->shaderBufferFloat32AtomicAdd &= atomics.shaderBufferFloat32AtomicAdd;
    }
}

static void layer_loaded(void) {}

// the card, as it has no memory, cannot be what wgpu runs on
static VkResult instance_created(VkInstance instance) {
    // once the instance is made, loaders answer with their first function, not with the next
    next_kind = (PFN_vkGetPhysicalDeviceProperties)next_instance_proc(instance, "vkGetPhysicalDeviceProperties");
    next_properties = (PFN_vkGetPhysicalDeviceProperties2)next_instance_proc(instance, "vkGetPhysicalDeviceProperties2");
    next_features = (PFN_vkGetPhysicalDeviceFeatures2)next_instance_proc(instance, "vkGetPhysicalDeviceFeatures2");
    if (card) return VK_SUCCESS;
    const char *driver = getenv("DPGES_COMPILED_DRIVER");
    void *library = driver ? dlopen(driver, RTLD_NOW | RTLD_LOCAL) : NULL;
    if (library == NULL) {
        fprintf(stderr, "compiled: DPGES_COMPILED_DRIVER: %s\n", driver ? dlerror() : "not set");
        return VK_ERROR_INITIALIZATION_FAILED;
    }
    VkResult (*negotiate)(uint32_t *) = (VkResult(*)(uint32_t *))dlsym(library, "vk_icdNegotiateLoaderICDInterfaceVersion");
    card_proc = (PFN_vkGetInstanceProcAddr)dlsym(library, "vk_icdGetInstanceProcAddr");
    uint32_t version = 5, n = 1;
    if (negotiate) negotiate(&version);
    VkApplicationInfo application = {VK_STRUCTURE_TYPE_APPLICATION_INFO, .apiVersion = VK_API_VERSION_1_3};
    VkInstanceCreateInfo info = {VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO, .pApplicationInfo = &application};
    if (card_proc == NULL || OF_CARD(vkCreateInstance)(&info, NULL, &card_instance) != VK_SUCCESS ||
        OF_CARD(vkEnumeratePhysicalDevices)(card_instance, &n, &card) < 0 || n == 0) {
        fprintf(stderr, "compiled: %s makes no card of RADV_FORCE_FAMILY\n", driver);
        return VK_ERROR_INITIALIZATION_FAILED;
    }
    VkPhysicalDeviceVulkan13Properties sizes = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_PROPERTIES};
    VkPhysicalDeviceProperties2 properties = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2, .pNext = &sizes};
    OF_CARD(vkGetPhysicalDeviceProperties2)(card, &properties);
    kind = properties.properties.deviceType;
    smallest_subgroup = sizes.minSubgroupSize;
    largest_subgroup = sizes.maxSubgroupSize;
    return VK_SUCCESS;
}

// with the features of the run's device, and of its extensions those that the card has
static VkResult device_created(const VkDeviceCreateInfo *info) {
    if (card_device) return VK_SUCCESS;
    uint32_t n = 0, wanted = info->enabledExtensionCount, used = 1;
    OF_CARD(vkEnumerateDeviceExtensionProperties)(card, NULL, &n, NULL);
    VkExtensionProperties *has = calloc(n, sizeof *has);
    const char **names = calloc(wanted + 1, sizeof *names);
    if (has == NULL || names == NULL) return VK_ERROR_OUT_OF_HOST_MEMORY;
    OF_CARD(vkEnumerateDeviceExtensionProperties)(card, NULL, &n, has);
    names[0] = VK_KHR_PIPELINE_EXECUTABLE_PROPERTIES_EXTENSION_NAME;
    for (uint32_t i = 0; i < wanted; i++)
        for (uint32_t j = 0; j < n; j++)
            if (!strcmp(info->ppEnabledExtensionNames[i], has[j].extensionName)) names[used++] = info->ppEnabledExtensionNames[i];
    VkPhysicalDevicePipelineExecutablePropertiesFeaturesKHR statistics = {
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PIPELINE_EXECUTABLE_PROPERTIES_FEATURES_KHR, (void *)info->pNext, VK_TRUE};
    VkDeviceCreateInfo changed = *info;
    changed.pNext = &statistics;
    changed.enabledExtensionCount = used;
    changed.ppEnabledExtensionNames = names;
    check(OF_CARD(vkCreateDevice)(card, &changed, NULL, &card_device), "vkCreateDevice");
    free(has);
    free(names);
    return VK_SUCCESS;
}

static PFN_vkVoidFunction taken(const char *name) {
    TAKE(name, vkGetPhysicalDeviceProperties, get_kind);
    TAKE(name, vkGetPhysicalDeviceProperties2, get_properties);
    TAKE(name, vkGetPhysicalDeviceProperties2KHR, get_properties);
    TAKE(name, vkGetPhysicalDeviceFeatures2, get_features);
    TAKE(name, vkGetPhysicalDeviceFeatures2KHR, get_features);
    TAKE(name, vkCreateShaderModule, create_shader_module);
    TAKE(name, vkCreateDescriptorSetLayout, create_set_layout);
    TAKE(name, vkCreatePipelineLayout, create_layout);
    TAKE(name, vkCreateRenderPass, create_render_pass);
    TAKE(name, vkCreateComputePipelines, create_compute_pipelines);
    TAKE(name, vkCreateGraphicsPipelines, create_graphics_pipelines);
    TAKE(name, vkSetDebugUtilsObjectNameEXT, name_object);
    TAKE(name, vkCmdBindPipeline, bind_pipeline);
    TAKE(name, vkCmdDispatch, dispatch);
    TAKE(name, vkCmdDispatchIndirect, dispatch_indirect);
    TAKE(name, vkCmdDraw, draw);
    TAKE(name, vkCmdDrawIndirect, draw_indirect);
    return NULL;
}

static void write_stage(FILE *table, const Pipeline *pipeline, uint32_t at, const VkPipelineExecutablePropertiesKHR *stage) {
    const char *name = "";
    for (uint32_t i = 0; i < pipeline->stages; i++)
        if (pipeline->flags[i] & stage->stages) name = pipeline->names[i];
    const uint32_t *size = pipeline->workgroup;
    unsigned long long launches = pipeline->launches, workgroups = pipeline->workgroups;
    fprintf(table, "{\"name\": \"%s\", \"pipeline\": \"%s\", \"workgroup\": [%u, %u, %u], ", name,
            pipeline->label ? pipeline->label : "", size[0], size[1], size[2]);
    fprintf(table, "\"subgroup\": %u, \"launches\": %llu, \"workgroups\": %llu, \"statistics\": {", stage->subgroupSize, launches,
            workgroups);
    VkPipelineExecutableInfoKHR info = {VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_INFO_KHR, NULL, pipeline->there, at};
    VkPipelineExecutableStatisticKHR found[MOST_STATISTICS] = {{0}};
    uint32_t n = MOST_STATISTICS;
    for (uint32_t i = 0; i < n; i++) found[i].sType = VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_STATISTIC_KHR;
    OF_CARD(vkGetPipelineExecutableStatisticsKHR)(card_device, &info, &n, found);
    for (uint32_t i = 0; i < n; i++)
        fprintf(table, "%s\"%s\": %llu", i ? ", " : "", found[i].name, (unsigned long long)found[i].value.u64);
    fputs("}}\n", table);
}

__attribute__((destructor)) static void report(void) {
    const char *path = getenv("DPGES_COMPILED_TABLE");
    FILE *table = path && card_device ? fopen(path, "w") : NULL;
    if (table == NULL) return;
    VkPhysicalDeviceVulkan12Properties driver = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_PROPERTIES};
    VkPhysicalDeviceProperties2 properties = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2, .pNext = &driver};
    OF_CARD(vkGetPhysicalDeviceProperties2)(card, &properties);
    fprintf(table, "{\"card\": \"%s\", \"driver\": \"%s\"}\n", properties.properties.deviceName, driver.driverInfo);
    for (size_t i = 0; i < n_pipelines; i++) {
        VkPipelineInfoKHR info = {VK_STRUCTURE_TYPE_PIPELINE_INFO_KHR, NULL, pipelines[i].there};
        VkPipelineExecutablePropertiesKHR stages[MOST_STAGES] = {{0}};
        uint32_t n = MOST_STAGES;
        for (uint32_t j = 0; j < n; j++) stages[j].sType = VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_PROPERTIES_KHR;
        OF_CARD(vkGetPipelineExecutablePropertiesKHR)(card_device, &info, &n, stages);
        for (uint32_t j = 0; j < n; j++) write_stage(table, &pipelines[i], j, &stages[j]);
    }
    fclose(table);
}
