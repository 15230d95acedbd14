/* A driver that shares Vulkan's memory, in place of one for GPUs: loaded before OpenCL, it adds to a CPU's device the
   extension cl_khr_external_memory with descriptors of lavapipe's memory, which are files that can be mapped. What was
   acquired cannot be acquired again, and what was not cannot be released. */
#define _GNU_SOURCE
#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <dlfcn.h>
#include <stdint.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#include <vulkan/vulkan.h>

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

enum { MOST = 64, DEVICE_UUID = 0x106A };
static struct { cl_mem memory; int is_acquired; } shared[MOST];
static int count;

static void find_uuid(uint8_t uuid[16]) {
    VkApplicationInfo about = {VK_STRUCTURE_TYPE_APPLICATION_INFO, .apiVersion = VK_API_VERSION_1_1};
    VkInstanceCreateInfo info = {VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO, .pApplicationInfo = &about};
    VkPhysicalDeviceIDProperties id = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ID_PROPERTIES};
    VkPhysicalDeviceProperties2 told = {VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2, &id};
    VkPhysicalDevice device;
    VkInstance instance;
    uint32_t one = 1;
    vkCreateInstance(&info, NULL, &instance);
    vkEnumeratePhysicalDevices(instance, &one, &device);
    vkGetPhysicalDeviceProperties2(device, &told);
    memcpy(uuid, id.deviceUUID, 16);
    vkDestroyInstance(instance, NULL);
}

cl_int clGetDeviceInfo(cl_device_id device, cl_device_info what, size_t room, void *value, size_t *used) {
    cl_int error;
    if (what == DEVICE_UUID) {
        find_uuid(value);
        return CL_SUCCESS;
    }
    error = NEXT(clGetDeviceInfo)(device, what, room, value, used);
    if (!error && what == CL_DEVICE_EXTENSIONS && value) strcat(value, " cl_khr_external_memory_opaque_fd");
    return error;
}

/* The file of lavapipe's memory begins with a header: its size, then where the bytes begin. */
cl_mem clCreateBufferWithProperties(cl_context context, const intptr_t *properties, cl_mem_flags flags, size_t size,
                                    void *host, cl_int *error) {
    const int descriptor = (int)properties[1];
    struct stat file;
    char *mapped;
    (void)host;
    fstat(descriptor, &file);
    mapped = mmap(NULL, (size_t)file.st_size, PROT_READ | PROT_WRITE, MAP_SHARED, descriptor, 0);
    close(descriptor);
    mapped += ((uint64_t *)mapped)[1];
    shared[count].memory = clCreateBuffer(context, flags | CL_MEM_USE_HOST_PTR, size, mapped, error);
    return shared[count++].memory;
}

static cl_int exchange(cl_command_queue queue, cl_uint number, const cl_mem *memory, int acquires) {
    cl_uint i;
    int k;
    for (i = 0; i < number; ++i) {
        for (k = 0; k < count && shared[k].memory != memory[i]; ++k) continue;
        if (k == count || shared[k].is_acquired == acquires) return CL_INVALID_OPERATION;
        shared[k].is_acquired = acquires;
    }
    return clEnqueueMarkerWithWaitList(queue, 0, NULL, NULL);
}

static cl_int acquire(cl_command_queue queue, cl_uint number, const cl_mem *memory, cl_uint waits,
                      const cl_event *events, cl_event *done) {
    (void)waits, (void)events, (void)done;
    return exchange(queue, number, memory, 1);
}

static cl_int release(cl_command_queue queue, cl_uint number, const cl_mem *memory, cl_uint waits,
                      const cl_event *events, cl_event *done) {
    (void)waits, (void)events, (void)done;
    return exchange(queue, number, memory, 0);
}

void *clGetExtensionFunctionAddressForPlatform(cl_platform_id platform, const char *name) {
    if (!strcmp(name, "clEnqueueAcquireExternalMemObjectsKHR")) return (void *)acquire;
    if (!strcmp(name, "clEnqueueReleaseExternalMemObjectsKHR")) return (void *)release;
    return NEXT(clGetExtensionFunctionAddressForPlatform)(platform, name);
}
