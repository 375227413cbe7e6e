// A Vulkan layer over a driver that compiles without a device behind it, such as Mesa's RADV under RADV_FORCE_FAMILY.
//
// It writes what the compiler says of each compute pipeline to the file that STATISTICS names, as a line of JSON:
// entry point, workgroup size, and the statistics of VK_KHR_pipeline_executable_properties. Such a driver has no
// memory types, no fences and no semaphores, and cannot record commands; so the layer invents the former and drops the
// latter, and every submission is complete at once. Results are zeros.
//
// If MODULES names a folder, the SPIR-V of each shader module goes there, as N.spv, and N into the line.
//
// One device at a time.
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <vulkan/vk_layer.h>
#include <vulkan/vulkan.h>

static PFN_vkGetInstanceProcAddr next_of_instance;
static PFN_vkGetDeviceProcAddr next_of_device;
static VkInstance instance_below;
// Asked for at once: later the loader would answer with this layer's own functions.
static PFN_vkGetPhysicalDeviceMemoryProperties memory_below;
static PFN_vkGetPhysicalDeviceMemoryProperties2 memory2_below;
static VkDevice device_below;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static FILE *statistics;

#define BELOW(name) ((PFN_vk##name)next_of_device(device_below, "vk" #name))

// What is known of a handle: number and workgroup size of a shader module, or the value of a semaphore.
typedef struct {
    uint64_t handle;
    uint64_t value;
    uint32_t workgroup[3];
} Known;

// Open addressing. A program that outgrows it is stopped rather than misread.
enum { KNOWN = 1 << 16 };
static Known known[KNOWN];

static Known *about(uint64_t handle) {
    for (uint32_t tries = 0, at = (uint32_t)((handle * 0x9E3779B97F4A7C15ull) >> 48); tries < KNOWN; tries++, at = (at + 1) % KNOWN) {
        if (known[at].handle == 0) known[at].handle = handle;
        if (known[at].handle == handle) return &known[at];
    }
    fprintf(stderr, "layer.c: more than %d handles\n", KNOWN);
    abort();
}

static VkLayerInstanceCreateInfo *link_of_instance(const void *chain) {
    for (VkLayerInstanceCreateInfo *at = (void *)chain; at; at = (void *)at->pNext)
        if (at->sType == VK_STRUCTURE_TYPE_LOADER_INSTANCE_CREATE_INFO && at->function == VK_LAYER_LINK_INFO) return at;
    return NULL;
}

static VkLayerDeviceCreateInfo *link_of_device(const void *chain) {
    for (VkLayerDeviceCreateInfo *at = (void *)chain; at; at = (void *)at->pNext)
        if (at->sType == VK_STRUCTURE_TYPE_LOADER_DEVICE_CREATE_INFO && at->function == VK_LAYER_LINK_INFO) return at;
    return NULL;
}

static VKAPI_ATTR VkResult VKAPI_CALL own_CreateInstance(const VkInstanceCreateInfo *info, const VkAllocationCallbacks *a,
                                                         VkInstance *instance) {
    VkLayerInstanceCreateInfo *link = link_of_instance(info->pNext);
    if (!link) return VK_ERROR_INITIALIZATION_FAILED;
    next_of_instance = link->u.pLayerInfo->pfnNextGetInstanceProcAddr;
    link->u.pLayerInfo = link->u.pLayerInfo->pNext;
    VkResult result = ((PFN_vkCreateInstance)next_of_instance(NULL, "vkCreateInstance"))(info, a, instance);
    if (result != VK_SUCCESS) return result;
    instance_below = *instance;
    memory_below = (PFN_vkGetPhysicalDeviceMemoryProperties)next_of_instance(*instance, "vkGetPhysicalDeviceMemoryProperties");
    memory2_below =
        (PFN_vkGetPhysicalDeviceMemoryProperties2)next_of_instance(*instance, "vkGetPhysicalDeviceMemoryProperties2");
    return VK_SUCCESS;
}

// Asks for the statistics, too.
static VKAPI_ATTR VkResult VKAPI_CALL own_CreateDevice(VkPhysicalDevice physical, const VkDeviceCreateInfo *info,
                                                       const VkAllocationCallbacks *a, VkDevice *device) {
    VkLayerDeviceCreateInfo *link = link_of_device(info->pNext);
    if (!link) return VK_ERROR_INITIALIZATION_FAILED;
    next_of_device = link->u.pLayerInfo->pfnNextGetDeviceProcAddr;
    PFN_vkCreateDevice create =
        (PFN_vkCreateDevice)link->u.pLayerInfo->pfnNextGetInstanceProcAddr(instance_below, "vkCreateDevice");
    link->u.pLayerInfo = link->u.pLayerInfo->pNext;

    uint32_t count = info->enabledExtensionCount;
    const char **names = malloc((count + 1) * sizeof *names);
    if (!names) return VK_ERROR_OUT_OF_HOST_MEMORY;
    if (count) memcpy(names, info->ppEnabledExtensionNames, count * sizeof *names);
    names[count] = VK_KHR_PIPELINE_EXECUTABLE_PROPERTIES_EXTENSION_NAME;
    VkPhysicalDevicePipelineExecutablePropertiesFeaturesKHR feature = {
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PIPELINE_EXECUTABLE_PROPERTIES_FEATURES_KHR, (void *)info->pNext, VK_TRUE};
    VkDeviceCreateInfo more = *info;
    more.pNext = &feature;
    more.enabledExtensionCount = count + 1;
    more.ppEnabledExtensionNames = names;
    VkResult result = create(physical, &more, a, device);
    free(names);
    if (result == VK_SUCCESS) {
        device_below = *device;
        const char *path = getenv("STATISTICS");
        if (!statistics) statistics = path ? fopen(path, "a") : stderr;
        if (!statistics) return VK_ERROR_INITIALIZATION_FAILED;
    }
    return result;
}

static void write_module(uint64_t number, const VkShaderModuleCreateInfo *info) {
    const char *folder = getenv("MODULES");
    if (!folder) return;
    char path[4096];
    snprintf(path, sizeof path, "%s/%llu.spv", folder, (unsigned long long)number);
    FILE *file = fopen(path, "wb");
    if (!file || fwrite(info->pCode, 1, info->codeSize, file) != info->codeSize || fclose(file)) {
        fprintf(stderr, "layer.c: cannot write %s\n", path);
        abort();
    }
}

// Remembers the workgroup size, which the statistics lack: OpExecutionMode (16) LocalSize (17) x y z.
static VKAPI_ATTR VkResult VKAPI_CALL own_CreateShaderModule(VkDevice device, const VkShaderModuleCreateInfo *info,
                                                             const VkAllocationCallbacks *a, VkShaderModule *module) {
    VkResult result = BELOW(CreateShaderModule)(device, info, a, module);
    if (result != VK_SUCCESS) return result;
    pthread_mutex_lock(&lock);
    static uint64_t modules;
    Known *own = about((uint64_t)*module);
    own->value = modules++;
    write_module(own->value, info);
    uint32_t *workgroup = own->workgroup;
    size_t words = info->codeSize / 4, length;
    for (size_t at = 5; at < words && (length = info->pCode[at] >> 16) > 0; at += length)
        if ((info->pCode[at] & 0xffff) == 16 && length == 6 && info->pCode[at + 2] == 17)
            memcpy(workgroup, &info->pCode[at + 3], 3 * sizeof *workgroup);
    pthread_mutex_unlock(&lock);
    return result;
}

static void print_statistics(VkDevice device, VkPipeline pipeline) {
    VkPipelineExecutableInfoKHR of = {VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_INFO_KHR, NULL, pipeline, 0};
    VkPipelineExecutableStatisticKHR all[64] = {0};
    uint32_t count = sizeof all / sizeof *all;
    for (uint32_t k = 0; k < count; k++) all[k].sType = VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_STATISTIC_KHR;
    if (BELOW(GetPipelineExecutableStatisticsKHR)(device, &of, &count, all) < 0) count = 0;
    for (uint32_t k = 0; k < count; k++) {
        fprintf(statistics, ",\"%s\":", all[k].name);
        switch (all[k].format) {
        case VK_PIPELINE_EXECUTABLE_STATISTIC_FORMAT_BOOL32_KHR: fprintf(statistics, "%u", all[k].value.b32); break;
        case VK_PIPELINE_EXECUTABLE_STATISTIC_FORMAT_INT64_KHR: fprintf(statistics, "%lld", (long long)all[k].value.i64); break;
        case VK_PIPELINE_EXECUTABLE_STATISTIC_FORMAT_UINT64_KHR:
            fprintf(statistics, "%llu", (unsigned long long)all[k].value.u64);
            break;
        default: fprintf(statistics, "%g", all[k].value.f64);
        }
    }
}

static VKAPI_ATTR VkResult VKAPI_CALL own_CreateComputePipelines(VkDevice device, VkPipelineCache cache, uint32_t count,
                                                                 const VkComputePipelineCreateInfo *infos,
                                                                 const VkAllocationCallbacks *a, VkPipeline *pipelines) {
    (void)cache; // What is taken from a cache may lack statistics.
    for (uint32_t k = 0; k < count; k++) {
        VkComputePipelineCreateInfo info = infos[k];
        info.flags |= VK_PIPELINE_CREATE_CAPTURE_STATISTICS_BIT_KHR;
        VkResult result = BELOW(CreateComputePipelines)(device, VK_NULL_HANDLE, 1, &info, a, &pipelines[k]);
        pthread_mutex_lock(&lock);
        const Known *module = about((uint64_t)info.stage.module);
        const uint32_t *workgroup = module->workgroup;
        fprintf(statistics, "{\"kernel\":\"%s\",\"module\":%llu,\"result\":%d,\"workgroup\":[%u,%u,%u]", info.stage.pName,
                (unsigned long long)module->value, result, workgroup[0], workgroup[1], workgroup[2]);
        if (result == VK_SUCCESS) print_statistics(device, pipelines[k]);
        fprintf(statistics, "}\n");
        fflush(statistics);
        pthread_mutex_unlock(&lock);
        if (result != VK_SUCCESS) return result;
    }
    return VK_SUCCESS;
}

// Memory.

static void invent_memory(VkPhysicalDeviceMemoryProperties *memory) {
    if (memory->memoryTypeCount) return;
    VkMemoryPropertyFlags host = VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
    memory->memoryHeapCount = 2;
    memory->memoryHeaps[0] = (VkMemoryHeap){16ull << 30, VK_MEMORY_HEAP_DEVICE_LOCAL_BIT};
    memory->memoryHeaps[1] = (VkMemoryHeap){16ull << 30, 0};
    memory->memoryTypeCount = 3;
    memory->memoryTypes[0] = (VkMemoryType){VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, 0};
    memory->memoryTypes[1] = (VkMemoryType){host, 1};
    memory->memoryTypes[2] = (VkMemoryType){host | VK_MEMORY_PROPERTY_HOST_CACHED_BIT, 1};
}

static VKAPI_ATTR void VKAPI_CALL own_GetPhysicalDeviceMemoryProperties(VkPhysicalDevice physical,
                                                                        VkPhysicalDeviceMemoryProperties *memory) {
    memory_below(physical, memory);
    invent_memory(memory);
}

static VKAPI_ATTR void VKAPI_CALL own_GetPhysicalDeviceMemoryProperties2(VkPhysicalDevice physical,
                                                                         VkPhysicalDeviceMemoryProperties2 *memory) {
    memory2_below(physical, memory);
    invent_memory(&memory->memoryProperties);
}

static void invent_types(VkMemoryRequirements *requirements) {
    if (!requirements->memoryTypeBits) requirements->memoryTypeBits = 7;
}

static VKAPI_ATTR void VKAPI_CALL own_GetBufferMemoryRequirements(VkDevice device, VkBuffer buffer, VkMemoryRequirements *out) {
    BELOW(GetBufferMemoryRequirements)(device, buffer, out);
    invent_types(out);
}

static VKAPI_ATTR void VKAPI_CALL own_GetBufferMemoryRequirements2(VkDevice device, const VkBufferMemoryRequirementsInfo2 *of,
                                                                   VkMemoryRequirements2 *out) {
    BELOW(GetBufferMemoryRequirements2)(device, of, out);
    invent_types(&out->memoryRequirements);
}

static VKAPI_ATTR void VKAPI_CALL own_GetImageMemoryRequirements(VkDevice device, VkImage image, VkMemoryRequirements *out) {
    BELOW(GetImageMemoryRequirements)(device, image, out);
    invent_types(out);
}

// Fences and semaphores: numbers that no driver hands out.

static uint64_t next_invented = 0x7000000000000000ull;

static uint64_t invent(uint64_t value) {
    pthread_mutex_lock(&lock);
    uint64_t handle = next_invented += 16;
    about(handle)->value = value;
    pthread_mutex_unlock(&lock);
    return handle;
}

static VKAPI_ATTR VkResult VKAPI_CALL own_CreateFence(VkDevice device, const VkFenceCreateInfo *info,
                                                      const VkAllocationCallbacks *a, VkFence *fence) {
    (void)device, (void)info, (void)a;
    *fence = (VkFence)invent(0);
    return VK_SUCCESS;
}

static VKAPI_ATTR VkResult VKAPI_CALL own_CreateSemaphore(VkDevice device, const VkSemaphoreCreateInfo *info,
                                                          const VkAllocationCallbacks *a, VkSemaphore *semaphore) {
    (void)device, (void)a;
    uint64_t value = 0;
    for (const VkBaseInStructure *at = info->pNext; at; at = at->pNext)
        if (at->sType == VK_STRUCTURE_TYPE_SEMAPHORE_TYPE_CREATE_INFO)
            value = ((const VkSemaphoreTypeCreateInfo *)at)->initialValue;
    *semaphore = (VkSemaphore)invent(value);
    return VK_SUCCESS;
}

// Its timeline semaphores reach their values at once.
static VKAPI_ATTR VkResult VKAPI_CALL own_QueueSubmit(VkQueue queue, uint32_t count, const VkSubmitInfo *infos, VkFence fence) {
    (void)queue, (void)fence;
    pthread_mutex_lock(&lock);
    for (uint32_t k = 0; k < count; k++) {
        const VkTimelineSemaphoreSubmitInfo *timeline = NULL;
        for (const VkBaseInStructure *at = infos[k].pNext; at; at = at->pNext)
            if (at->sType == VK_STRUCTURE_TYPE_TIMELINE_SEMAPHORE_SUBMIT_INFO) timeline = (const void *)at;
        for (uint32_t s = 0; timeline && s < timeline->signalSemaphoreValueCount && s < infos[k].signalSemaphoreCount; s++) {
            Known *semaphore = about((uint64_t)infos[k].pSignalSemaphores[s]);
            uint64_t value = timeline->pSignalSemaphoreValues[s];
            if (value > semaphore->value) semaphore->value = value;
        }
    }
    pthread_mutex_unlock(&lock);
    return VK_SUCCESS;
}

static VKAPI_ATTR VkResult VKAPI_CALL own_GetSemaphoreCounterValue(VkDevice device, VkSemaphore semaphore, uint64_t *value) {
    (void)device;
    pthread_mutex_lock(&lock);
    *value = about((uint64_t)semaphore)->value;
    pthread_mutex_unlock(&lock);
    return VK_SUCCESS;
}

// For whatever needs no answer but success.
static VKAPI_ATTR VkResult VKAPI_CALL done(void) { return VK_SUCCESS; }

static int is_one_of(const char *name, const char *const *names) {
    for (; *names; names++)
        if (!strcmp(name, *names)) return 1;
    return 0;
}

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL own_GetDeviceProcAddr(VkDevice device, const char *name);
static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL own_GetInstanceProcAddr(VkInstance instance, const char *name);

static PFN_vkVoidFunction own(const char *name) {
    static const char *const dropped[] = {
        "vkBeginCommandBuffer", "vkEndCommandBuffer", "vkResetCommandBuffer", "vkResetCommandPool", "vkTrimCommandPool",
        "vkWaitSemaphores", "vkWaitSemaphoresKHR", "vkDestroySemaphore", "vkWaitForFences", "vkGetFenceStatus",
        "vkResetFences", "vkDestroyFence", "vkDeviceWaitIdle", "vkQueueWaitIdle", NULL};
#define OWN(function) \
    if (!strcmp(name, "vk" #function)) return (PFN_vkVoidFunction)own_##function
    OWN(CreateInstance);
    OWN(CreateDevice);
    OWN(GetInstanceProcAddr);
    OWN(GetDeviceProcAddr);
    OWN(CreateShaderModule);
    OWN(CreateComputePipelines);
    OWN(GetPhysicalDeviceMemoryProperties);
    OWN(GetPhysicalDeviceMemoryProperties2);
    OWN(GetBufferMemoryRequirements);
    OWN(GetBufferMemoryRequirements2);
    OWN(GetImageMemoryRequirements);
    OWN(CreateFence);
    OWN(CreateSemaphore);
    OWN(QueueSubmit);
    OWN(GetSemaphoreCounterValue);
#undef OWN
    if (!strcmp(name, "vkGetPhysicalDeviceMemoryProperties2KHR"))
        return (PFN_vkVoidFunction)own_GetPhysicalDeviceMemoryProperties2;
    if (!strcmp(name, "vkGetSemaphoreCounterValueKHR")) return (PFN_vkVoidFunction)own_GetSemaphoreCounterValue;
    if (!strncmp(name, "vkCmd", 5) || is_one_of(name, dropped)) return (PFN_vkVoidFunction)done;
    return NULL;
}

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL own_GetDeviceProcAddr(VkDevice device, const char *name) {
    PFN_vkVoidFunction function = own(name);
    return function ? function : next_of_device(device, name);
}

static VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL own_GetInstanceProcAddr(VkInstance instance, const char *name) {
    PFN_vkVoidFunction function = own(name);
    return function ? function : next_of_instance(instance, name);
}

VKAPI_ATTR VkResult VKAPI_CALL vkNegotiateLoaderLayerInterfaceVersion(VkNegotiateLayerInterface *version) {
    version->loaderLayerInterfaceVersion = 2;
    version->pfnGetInstanceProcAddr = own_GetInstanceProcAddr;
    version->pfnGetDeviceProcAddr = own_GetDeviceProcAddr;
    version->pfnGetPhysicalDeviceProcAddr = NULL;
    return VK_SUCCESS;
}
