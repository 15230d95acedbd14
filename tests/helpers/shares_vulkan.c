/* A driver that shares Vulkan's memory, in place of one for GPUs: loaded before OpenCL, it adds to a CPU's device the
   extension cl_khr_external_memory with descriptors of lavapipe's memory, which are files that can be mapped. What was
   acquired cannot be acquired again, and what was not cannot be released. Unless WITHOUT_SEMAPHORES is set, it also
   adds semaphores to both sides (VK_KHR_external_semaphore_fd, cl_khr_external_semaphore), which only note whether they
   are signaled: what signals is waited for at once, and what waits fails if it is not signaled. */
#define _GNU_SOURCE
#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <dlfcn.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#include <vulkan/vulkan.h>

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

enum { MOST = 64, DEVICE_UUID = 0x106A };
static struct { cl_mem memory; int is_acquired; } shared[MOST];
static int count;

enum { SEMAPHORES = 3 };
static const char *const SEMAPHORE_FD = "VK_KHR_external_semaphore_fd";
static int is_signaled[SEMAPHORES], semaphores = 1; /* their handles in both APIs are their numbers, from 1 on */

static int switched(intptr_t semaphore, int to) {
    if (semaphore < 1 || semaphore >= semaphores || is_signaled[semaphore] == to) return 0;
    is_signaled[semaphore] = to;
    return 1;
}

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
    if (!error && what == CL_DEVICE_EXTENSIONS && value) {
        strcat(value, " cl_khr_external_memory_opaque_fd");
        if (!getenv("WITHOUT_SEMAPHORES")) strcat(value, " cl_khr_external_semaphore_opaque_fd");
    }
    return error;
}

VkResult vkEnumerateDeviceExtensionProperties(VkPhysicalDevice device, const char *layer, uint32_t *number,
                                              VkExtensionProperties *found) {
    const VkResult result = NEXT(vkEnumerateDeviceExtensionProperties)(device, layer, number, found);
    if (found)
        strcpy(found[*number].extensionName, SEMAPHORE_FD);
    ++*number;
    return result;
}

VkResult vkCreateDevice(VkPhysicalDevice physical, const VkDeviceCreateInfo *given,
                        const VkAllocationCallbacks *allocation, VkDevice *device) {
    VkDeviceCreateInfo info = *given;
    if (info.enabledExtensionCount == 2) info.enabledExtensionCount = 1; /* without that of semaphores */
    return NEXT(vkCreateDevice)(physical, &info, allocation, device);
}

VkResult vkCreateSemaphore(VkDevice device, const VkSemaphoreCreateInfo *info, const VkAllocationCallbacks *allocation,
                           VkSemaphore *made) {
    (void)device, (void)info, (void)allocation;
    if (semaphores == SEMAPHORES) return VK_ERROR_OUT_OF_HOST_MEMORY;
    *made = (VkSemaphore)(intptr_t)semaphores++;
    return VK_SUCCESS;
}

void vkDestroySemaphore(VkDevice device, VkSemaphore semaphore, const VkAllocationCallbacks *allocation) {
    (void)device, (void)allocation;
    if (semaphore) --semaphores;
}

static VkResult descriptor_of(VkDevice device, const VkSemaphoreGetFdInfoKHR *info, int *descriptor) {
    (void)device;
    *descriptor = (int)(intptr_t)info->semaphore;
    return VK_SUCCESS;
}

PFN_vkVoidFunction vkGetDeviceProcAddr(VkDevice device, const char *name) {
    if (!strcmp(name, "vkGetSemaphoreFdKHR")) return (PFN_vkVoidFunction)descriptor_of;
    return NEXT(vkGetDeviceProcAddr)(device, name);
}

VkResult vkQueueSubmit(VkQueue queue, uint32_t number, const VkSubmitInfo *given, VkFence fence) {
    VkSubmitInfo info = *given;
    VkResult result;
    if (info.waitSemaphoreCount && !switched((intptr_t)info.pWaitSemaphores[0], 0)) return VK_ERROR_DEVICE_LOST;
    info.waitSemaphoreCount = info.signalSemaphoreCount = 0;
    result = NEXT(vkQueueSubmit)(queue, number, &info, fence);
    if (result || !given->signalSemaphoreCount) return result;
    if (!switched((intptr_t)given->pSignalSemaphores[0], 1)) return VK_ERROR_DEVICE_LOST;
    return vkQueueWaitIdle(queue);
}

static void *semaphore_of(cl_context context, const cl_ulong *properties, cl_int *error) {
    (void)context;
    *error = properties[0] == 0x203D && properties[1] == 1 && properties[2] == 0x2055 ? CL_SUCCESS : CL_INVALID_VALUE;
    return (void *)(intptr_t)properties[3];
}

static cl_int wait_for(cl_command_queue queue, cl_uint number, void *const *one, const cl_ulong *payload, cl_uint waits,
                       const cl_event *events, cl_event *done) {
    (void)queue, (void)number, (void)payload, (void)waits, (void)events, (void)done;
    return switched((intptr_t)*one, 0) ? CL_SUCCESS : CL_INVALID_OPERATION;
}

static cl_int signal_to(cl_command_queue queue, cl_uint number, void *const *one, const cl_ulong *payload,
                        cl_uint waits, const cl_event *events, cl_event *done) {
    (void)number, (void)payload, (void)waits, (void)events, (void)done;
    return switched((intptr_t)*one, 1) ? clFinish(queue) : CL_INVALID_OPERATION;
}

static cl_int forget(void *semaphore) {
    (void)semaphore;
    return CL_SUCCESS;
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

static cl_int exchange(cl_command_queue queue, cl_uint number, const cl_mem *memory, cl_event *done, int acquires) {
    cl_uint i;
    int k;
    for (i = 0; i < number; ++i) {
        for (k = 0; k < count && shared[k].memory != memory[i]; ++k) continue;
        if (k == count || shared[k].is_acquired == acquires) return CL_INVALID_OPERATION;
        shared[k].is_acquired = acquires;
    }
    return clEnqueueMarkerWithWaitList(queue, 0, NULL, done);
}

static cl_int acquire(cl_command_queue queue, cl_uint number, const cl_mem *memory, cl_uint waits,
                      const cl_event *events, cl_event *done) {
    (void)waits, (void)events;
    return exchange(queue, number, memory, done, 1);
}

static cl_int release(cl_command_queue queue, cl_uint number, const cl_mem *memory, cl_uint waits,
                      const cl_event *events, cl_event *done) {
    (void)waits, (void)events;
    return exchange(queue, number, memory, done, 0);
}

void *clGetExtensionFunctionAddressForPlatform(cl_platform_id platform, const char *name) {
    if (!strcmp(name, "clEnqueueAcquireExternalMemObjectsKHR")) return (void *)acquire;
    if (!strcmp(name, "clEnqueueReleaseExternalMemObjectsKHR")) return (void *)release;
    if (!strcmp(name, "clCreateSemaphoreWithPropertiesKHR")) return (void *)semaphore_of;
    if (!strcmp(name, "clEnqueueWaitSemaphoresKHR")) return (void *)wait_for;
    if (!strcmp(name, "clEnqueueSignalSemaphoresKHR")) return (void *)signal_to;
    if (!strcmp(name, "clReleaseSemaphoreKHR")) return (void *)forget;
    return NEXT(clGetExtensionFunctionAddressForPlatform)(platform, name);
}
